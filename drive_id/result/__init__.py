"""The result of a fit for its user: the identified drive and its origin."""
