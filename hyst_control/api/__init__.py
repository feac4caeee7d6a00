"""The front door, `import hyst_control as hc`: records, models, tunings and gaps, over the functions that the commands use too."""
