"""Ingest: raw files in, raw records out; nothing is altered, everything doubtful is flagged."""
