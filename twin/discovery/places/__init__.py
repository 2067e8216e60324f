"""Where something acts that the catalogue does not know."""
