"""POp-GS as policies, one for each criterion of optimal design ([popgs]); no travel term."""
