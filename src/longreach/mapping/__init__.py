"""Keyframes and the relative poses between them: pose graph, loop closures, and the map that comes of them."""
