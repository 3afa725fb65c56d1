"""Records of the pipeline: the report with the reason of every rejection, images of each stage.

May import pose and the layers below it.
"""
