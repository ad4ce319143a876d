"""The checker of certificates: trusts nobody, shares no code with what solves, needs python-flint and the standard library only."""
