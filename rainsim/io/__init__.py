"""Reading and writing files: pictures, videos, JSON."""
