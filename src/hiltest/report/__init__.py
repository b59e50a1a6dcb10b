"""Renderers: a run as HTML, Markdown, terminal text and figures. Nothing is decided here."""
