"""The thesis once more, dense and slow: what the fast code must agree with. Nothing of gpcjax is imported."""
