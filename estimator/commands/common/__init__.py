"""What commands share: what is printed and how, where images come from, views of a board in them.

May import calib, logs and vision; no command.
"""
