"""From scores to effects: forward steps, joint fits, and what may be claimed."""
