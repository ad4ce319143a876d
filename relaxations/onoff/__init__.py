"""On-off commands: profiles held in a form, least fuel at a given time, fuel and time weighted against each other."""
