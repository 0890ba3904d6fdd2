"""The audit: each claim of the paper as a check that computes its verdict."""
