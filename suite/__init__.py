"""Studies, requirements, campaigns, verdicts, evidence, and the command line `slewcert`."""
