"""Evidence of hypotheses: log marginal likelihoods with declared priors, the search, and the posterior."""
