"""What goes into the car: ONNX and the HMMs."""
