"""The three methods of identification, one interface: what each sums over samples, and what it estimates from that."""
