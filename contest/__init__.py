"""The open contest of observers: machines, uncertainties, entrants, and the referee who runs anybody's observer."""
