"""Trials of the network calibrator beside the other calibrators."""
