"""The gap report: attribution, breakdown, document and page."""
