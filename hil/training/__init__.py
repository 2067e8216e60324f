"""Training of the network calibrator on simulated rigs and the virtual rig's plant, never on recorded ones."""
