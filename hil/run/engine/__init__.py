"""Engine of a run: ticks, states, interlocks, requests of operators."""
