"""Models of yarn: frozen problem in, solution out. Knows numpy and scipy; no files, no tables, no plots."""
