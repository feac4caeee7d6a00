"""The verdict of a diagnosis: from evidence to a name, with its reasons."""
