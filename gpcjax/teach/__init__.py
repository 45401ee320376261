"""A person teaches a policy in the browser: `gpcjax teach`, with the extra `teach`."""
