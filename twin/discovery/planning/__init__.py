"""Planning of records: detectability and isolability before data, and the experiment that splits an ambiguity group."""
