"""Self-tuning feedforward vibration isolation: FeRLS against FeLMS on a six-axis hard-mount isolator."""
