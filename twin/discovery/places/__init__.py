"""Localisation of effects that the catalogue does not have."""
