"""The commands of the command line, one module each: options, then what they do."""
