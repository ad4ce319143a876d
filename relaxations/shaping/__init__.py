"""Shapers: impulse sequences that leave no vibration, of every kind, and how they are used."""
