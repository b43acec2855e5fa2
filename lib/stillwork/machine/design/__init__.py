"""The commands for a machine of one's own, one file each; they stand on the whole toolbox."""
