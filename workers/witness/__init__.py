"""The third witness: free-space votes of the seconds before and after each frame."""
