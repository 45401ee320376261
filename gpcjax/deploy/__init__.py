"""Policies that leave the lab: what one is, how well it does, and files in which it acts without gpcjax."""
