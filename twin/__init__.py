"""What we believe about the rig: a network of elements, its simulation and its calibrators."""
