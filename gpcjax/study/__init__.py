"""A study with people, many of them at once: `gpcjax study`, with the extra `teach`."""
