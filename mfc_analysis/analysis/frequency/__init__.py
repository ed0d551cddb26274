"""Frequency responses, crossings and peaks."""
