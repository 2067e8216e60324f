"""An effect fitted together with the tunables, and tried on what the fit never saw."""
