"""Leads: where to look in a record that no effect explains, each beyond what noise does by chance."""
