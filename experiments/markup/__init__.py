"""Markdown: tables, pages and the claims of the paper with their verdicts."""
