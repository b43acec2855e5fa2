"""The open contest of observers: machines, doubts, entrants, and the referee who runs anybody's observer."""
