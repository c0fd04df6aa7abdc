"""The extension, and the programs that it starts."""
