"""The open contest of observers: machines, uncertainties, entrants, and the runner of submitted observers."""
