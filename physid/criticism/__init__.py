"""physid.criticism"""
