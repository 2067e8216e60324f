"""Training data for the network calibrator: simulated rigs and the virtual rig's plant, never recorded ones."""
