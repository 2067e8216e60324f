"""The network calibrator's subject "cooling-tower cell": channels, memory, windows, training, gate and scores."""
