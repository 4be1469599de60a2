"""Results as text, JSON, pages and pictures. Renderers only format."""
