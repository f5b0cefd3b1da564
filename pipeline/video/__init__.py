"""Recordings of your own, videos and folders of images: import them as drives."""
