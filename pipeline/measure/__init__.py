"""Measure: raw records in, means with uncertainties out."""
