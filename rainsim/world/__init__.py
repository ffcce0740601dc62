"""A scene in the rain as files that other programs render: USD stages, and the ground as glTF."""
