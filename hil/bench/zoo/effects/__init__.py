"""Hidden effects of the zoo, each declared with the answers that count as right; nothing here imports `twin`."""
