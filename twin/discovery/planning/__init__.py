"""Before data: what a record could see, and the experiment that would decide."""
