"""Why the twin is wrong: the residual traced to an effect that the model lacks."""
