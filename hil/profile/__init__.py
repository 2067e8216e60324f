"""Load profiles, and the scenarios of ship systems that make them."""
