"""Plant FMUs: sources, build, safe opening, linearisation, co-simulation in a process of its own. Judges nothing."""
