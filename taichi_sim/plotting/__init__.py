"""The style of plots and HTML pages."""
