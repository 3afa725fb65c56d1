"""The outline path and registration on real aerial pictures, beside plain segmentation, SIFT and decoys."""
