"""The pipeline: ingest → measure → predict → compare → report."""
