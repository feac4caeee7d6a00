"""Tests of a fitted candidate: constancy, reduction on left-out samples, presence in baseline records."""
