"""Mathematics of fast, vibration-free motion: plants, maneuvers, commands, linear programs, refinement and bounds."""
