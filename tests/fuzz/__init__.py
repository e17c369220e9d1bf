"""Damaged files through the real readers: `python -m tests.fuzz --count 20000`."""
