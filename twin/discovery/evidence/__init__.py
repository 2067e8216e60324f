"""One evidence for every hypothesis: log marginal likelihoods with declared priors, the search and the posterior."""
