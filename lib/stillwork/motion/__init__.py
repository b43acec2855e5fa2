"""Motion: observers that raise the bandwidth of flexible motion systems (the observer thesis)."""
