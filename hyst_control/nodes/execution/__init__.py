"""Executor, timers, exchange within a process, signals of the operating system, and the ends of nodes."""
