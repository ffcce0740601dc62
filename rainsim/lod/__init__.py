"""Big captures: cut into chunks of several levels, and drawn from those that a camera needs."""
