"""physid.identification"""
