"""Studies: settings that learn from sources, compared in tables and figures."""
