"""Identification by iterative learning control: parameters learned by flying, again and again."""
