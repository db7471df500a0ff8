"""What several test files share: reference implementations, random inputs, small towns, and calls of scripts."""
