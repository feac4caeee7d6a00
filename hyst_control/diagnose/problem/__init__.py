"""Problem of a diagnosis: records, simulator, uncertain coefficients, stages of one record."""
