"""How NAF is trained: the values of the recipes, and a training by them."""
