"""The extension, and the modules that it opens."""
