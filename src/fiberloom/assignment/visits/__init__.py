"""Assignment over many exposures: targets that want several visits, minimum numbers in every sector."""
