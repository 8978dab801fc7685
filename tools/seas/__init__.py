"""Parts of the tools that draw seas."""
