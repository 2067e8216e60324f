"""Verdict of a diagnosis from a finding: acceptance, isolation, ambiguity groups, and the sentences of the report."""
