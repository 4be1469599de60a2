"""The live screen: what flies, arm by arm. Nothing here commands a vehicle or writes to it.

`incoming` keeps what came over a link or out of a recording, `state` makes one frozen moment of it, `screen`
shows that moment. Each knows only the one before.
"""
