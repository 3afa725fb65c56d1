"""What the way through leaves behind: the report with the reason of every refusal, the images of each stage.

May import pose and what is below it.
"""
