"""Records: report with reasons of rejection, images of each stage.

May import pose and the layers below it.
"""
