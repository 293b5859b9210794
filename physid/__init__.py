"""physid"""
