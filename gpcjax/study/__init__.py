"""A study with people: `gpcjax study`, with the extra `teach`. Many of them teach at once, single-blind."""
