"""The neutral document: a tree of sections, tables, figures and verdicts."""
