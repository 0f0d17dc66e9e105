"""The pictures of docs/, remade by `make pictures`: MuJoCo without a screen, and Pillow for what is written on top."""
