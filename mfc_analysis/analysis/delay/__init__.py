"""Exact analysis of dead time."""
