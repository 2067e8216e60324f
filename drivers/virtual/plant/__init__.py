"""Plant of the virtual rig and its instruments."""
