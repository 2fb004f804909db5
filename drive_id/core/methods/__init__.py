"""The three methods of identification, one interface: what each estimates from sums over samples."""
