"""Training of the network calibrator for cooling-tower cells, on simulated stations alone."""
