"""Trials of the network calibrator and the other calibrators."""
