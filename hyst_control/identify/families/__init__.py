"""Common ground of the model families: declaration, options and registration."""
