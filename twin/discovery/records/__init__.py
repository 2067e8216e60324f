"""Records of a diagnosis: even grid, noise, stuck readings and standstills."""
