"""What differs between environments: sea and wind of each realisation, numbers of each vehicle."""
