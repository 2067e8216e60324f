"""Structure identification without a healthy record: the set of effects that a record needs."""
