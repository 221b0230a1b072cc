"""Report: results in, figures, tables, notebook and one HTML page out."""
