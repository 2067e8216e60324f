"""Records of a plant historian: tags, defects, minutes, regimes and events. Pure functions on arrays."""
