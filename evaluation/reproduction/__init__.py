"""The experiments of the papers and of the public measurements, table by table."""
