"""physid.plant"""
