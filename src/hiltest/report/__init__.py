"""Renderers of a run as HTML, Markdown, terminal text and figures. They decide nothing."""
