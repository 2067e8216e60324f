"""Random thermal plants with equations of their own; nothing here imports `twin`."""
