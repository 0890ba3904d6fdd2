"""Markdown by templates: tables, and the paper's claims with their verdicts."""
