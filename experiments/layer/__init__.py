"""Plants and identifications inside differentiable programs."""
