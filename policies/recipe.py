"""What the arm policy is promised and how it is taught: every number of the recipe."""
