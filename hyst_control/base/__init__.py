"""Ground of every room: errors, files, progress, processes, plugins, configuration files."""
