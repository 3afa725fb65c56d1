"""The outline path and registration on real aerial images, with plain segmentation, SIFT and decoys."""
