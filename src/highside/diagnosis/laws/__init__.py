"""Laws found from the readings, where no effect of the library explains them. Not built yet."""
